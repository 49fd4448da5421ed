"""`temporal_ensemble`: chunk execution over any other policy."""
