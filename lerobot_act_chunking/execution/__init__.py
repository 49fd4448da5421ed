"""From predicted chunks to one action per control step. Tensors in, tensors out."""
