"""From predicted chunks to one action per control step. Tensors around `act_chunking_runtime`."""
