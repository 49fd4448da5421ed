"""What a tokenizer's codes are used for, what they lose, and whether they still fit the data."""
