"""Denoising policies: diffusion, flow matching and two-step regression."""
