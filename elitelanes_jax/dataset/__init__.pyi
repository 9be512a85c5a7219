from ._sampling import draw_sample as draw_sample
from .joining import merge_dataset as merge_dataset
from .make import make_dataset as make_dataset
from .scoring import score_predictions as score_predictions
from .spec import DatasetSpec as DatasetSpec
