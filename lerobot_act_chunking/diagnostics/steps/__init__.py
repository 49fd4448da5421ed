"""How many denoising steps a policy needs for a given precision, and whether steps can help at all."""
