"""The `vqbet_chunked` policy."""
