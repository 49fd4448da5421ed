"""Which of several policies succeeds more often, and how sure that is."""
