"""Maps that are kept up to date: the evidence of several recordings is pooled."""

from anisomap.tracking.evidence import Evidence as Evidence
from anisomap.tracking.evidence import gather_evidence as gather_evidence
from anisomap.tracking.evidence import map_evidence as map_evidence
from anisomap.tracking.moves import Moves as Moves
from anisomap.tracking.updating import Update as Update
from anisomap.tracking.updating import update_map as update_map
