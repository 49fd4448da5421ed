"""Whether a policy's encoder gains from a language model's weights, and from which of them."""
