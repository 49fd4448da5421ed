"""Is a policy's latent in use, and does acting sample styles that were demonstrated?"""
