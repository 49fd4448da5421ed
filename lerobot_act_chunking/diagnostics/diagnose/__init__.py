"""Why a policy fails, by observation and by intervention on the same episodes."""
