"""A sentence encoder that knows a few words and has learned nothing, as transformers saves one."""

from pathlib import Path

import torch

LEFT, RIGHT = "hand the red cube to the left arm", "pass the blue block to the right arm"
WORDS = ("[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", *f"{LEFT} {RIGHT} give green do toy".split())


def tiny_encoder(folder: Path, seed: int = 0) -> str:
    """Makes one; other seeds have other weights."""
    from transformers import BertConfig, BertModel, BertTokenizer
    from transformers.utils import logging

    logging.disable_progress_bar()
    folder.mkdir(parents=True)
    vocabulary = {word: number for number, word in enumerate(dict.fromkeys(WORDS))}
    torch.manual_seed(seed)
    sizes = {"hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 32}
    BertModel(BertConfig(vocab_size=len(vocabulary), max_position_embeddings=24, **sizes)).save_pretrained(
        folder
    )
    BertTokenizer(vocabulary, model_max_length=24).save_pretrained(folder)
    return str(folder)
