from .approximation import reconstruct_approximately as reconstruct_approximately
from .device import reconstruct_on_device as reconstruct_on_device
from .map_reduce import WorkerPool as WorkerPool
from .sensor_graph import ApproximateOptions as ApproximateOptions
from .streaming import reconstruct_chunks as reconstruct_chunks
