from .session import LiveSession as LiveSession
from .sources import open_source as open_source
from .workers import ExaminationOptions as ExaminationOptions
