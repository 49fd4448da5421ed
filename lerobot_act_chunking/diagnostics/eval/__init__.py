"""How often policies succeed, with everything written down that explains why they do or do not."""
