"""Which tokenizer suits a dataset: all of them, like for like."""
