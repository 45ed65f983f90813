from .approximation import reconstruct_approximately as reconstruct_approximately
from .landmarks.options import ApproximateOptions as ApproximateOptions
from .map_reduce import WorkerPool as WorkerPool
from .streaming import reconstruct_chunks as reconstruct_chunks
