"""What a checkpoint would do where demonstrators were; without a simulation."""
