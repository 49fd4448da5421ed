"""Latents of a conditional VAE: what a style of acting is, and which styles are sampled when acting."""
