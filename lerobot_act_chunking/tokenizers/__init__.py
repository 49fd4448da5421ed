"""Actions as tokens: from chunks of actions to codes and back."""
