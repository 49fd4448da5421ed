"""Which execution suits a trained policy, by measurement."""
