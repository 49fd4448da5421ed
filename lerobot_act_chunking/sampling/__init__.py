"""Generative sampling: noising processes, samplers, noise. Tensors in, tensors out; networks live in nn."""
