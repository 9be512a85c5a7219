from ._widget import show as show
from .page import explore as explore
