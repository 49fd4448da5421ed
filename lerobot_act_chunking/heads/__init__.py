"""Action heads: features of action queries to actions, and how a prediction is scored."""
