"""Policies that follow instructions: what an instruction is made into, and what happens when it changes."""
