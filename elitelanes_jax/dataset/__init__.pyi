from ._samples import draw_sample as draw_sample
from ._transforms import Transforms as Transforms
from ._transforms import Viewpoints as Viewpoints
from .joining import merge_dataset as merge_dataset
from .make import make_dataset as make_dataset
from .spec import DatasetSpec as DatasetSpec
