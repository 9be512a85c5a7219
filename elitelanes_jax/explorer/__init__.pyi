from ._collect import collect as collect
from ._widget import show as show
from .page import explore as explore
from .page import page_of as page_of
