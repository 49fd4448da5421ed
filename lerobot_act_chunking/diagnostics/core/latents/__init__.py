"""Latents of `act_chunked`: the policy, and what its latent makes of demonstrations."""
