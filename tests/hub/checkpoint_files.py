"""What the fixture `folder` holds."""

FILES = ["README.md", "config.json", "model.safetensors", "sub/empty.txt", "sub/state.safetensors"]
