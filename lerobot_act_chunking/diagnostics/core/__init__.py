"""What the instruments share: what is read, run, measured in space, judged and reported."""
