"""What a dataset of demonstrations is like, before anything is trained on it."""
