"""The frame cache: every frame of a dataset's videos is decoded once, at the size that training reads it.

`store` keeps one camera's frames in a file, `cache` decides which stores there are and makes room for them,
`source` gathers the frames of a batch, and `filling` is a process of its own that decodes ahead.

What is stored is what LeRobot's decoder gave, resized where a policy asks for it; everything random, such as
LeRobot's image transforms, comes afterwards. No frame is lost with the cache: what is not in it, or does not
have the checksum that was stored with it, is decoded.
"""
