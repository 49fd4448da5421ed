"""Action Chunking with Transformers (Zhao et al. 2023), built from the package's blocks."""
