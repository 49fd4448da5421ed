"""How fast a policy that executes overlapping chunks can answer what its plan did not foresee."""
