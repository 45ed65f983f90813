from .device import reconstruct_on_device as reconstruct_on_device
