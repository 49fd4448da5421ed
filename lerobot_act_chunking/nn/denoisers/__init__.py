"""Networks that clean noisy action chunks, given what was observed."""
