from .collect import collect as collect
from .page import explore as explore
from .widget import show as show
