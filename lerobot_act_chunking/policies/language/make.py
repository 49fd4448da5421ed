"""What a policy's network makes of instructions, from its settings."""

from lerobot_act_chunking.nn.instruction import READERS, InstructionEmbedding
from lerobot_act_chunking.policies.language.encoder import load_encoder
from lerobot_act_chunking.policies.language.fields import INSTRUCTION, LanguageFields


def make_instruction(config: LanguageFields) -> InstructionEmbedding | None:
    """What makes a vector of each instruction; None for a policy that reads none."""
    if config.language_encoder is None:
        return None
    reader = READERS[config.language_reading](load_encoder(config.language_encoder).width)
    return InstructionEmbedding(reader, with_null=config.instruction_dropout > 0)


def instruction_dims(instruction: InstructionEmbedding | None) -> dict[str, int]:
    """Name and size of the vector that joins the observed ones."""
    return {} if instruction is None else {INSTRUCTION: instruction.reader.dim}
