from ._collect import collect as collect
from ._collect import collect_results as collect_results
from ._widget import show as show
from .page import explore as explore
from .page import page_of as page_of
