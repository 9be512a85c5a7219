from .cluster import dask_executor as dask_executor
from .cluster import generate_on as generate_on
from .generation import generate as generate
from .generation import merge as merge
from .picking import pick as pick
from .spec import GenerateSpec as GenerateSpec
from .spec import PickSpec as PickSpec
