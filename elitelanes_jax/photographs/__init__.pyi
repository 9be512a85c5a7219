from .cutting import Cut as Cut
from .cutting import cut_tiles as cut_tiles
from .cutting import write_cuts as write_cuts
from .proposals import Proposal as Proposal
from .proposals import propose_tiles as propose_tiles
from .reading import Photograph as Photograph
