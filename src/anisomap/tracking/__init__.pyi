from .evidence import Evidence as Evidence
from .evidence import PairSums as PairSums
from .evidence import gather_evidence as gather_evidence
from .evidence import map_evidence as map_evidence
from .updating import Moves as Moves
from .updating import Update as Update
from .updating import update_map as update_map
