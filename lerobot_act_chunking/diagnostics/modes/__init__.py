"""Does a policy take the ways that were demonstrated, as often; if not, why, and what repairs it?"""
