"""The network of `vqbet_chunked`: a GPT over observations and action queries, heads for codes and offsets."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.heads.codes import CodeHead
from lerobot_act_chunking.heads.offsets import ConditionedOffset, TableOffset
from lerobot_act_chunking.nn.condition import CameraKeypoints
from lerobot_act_chunking.nn.gpt import Gpt
from lerobot_act_chunking.nn.history import HistoryTokens
from lerobot_act_chunking.nn.instruction import InstructionEmbedding
from lerobot_act_chunking.nn.prefix import GivenActions, PrefixEncoder
from lerobot_act_chunking.nn.vision import make_backbone
from lerobot_act_chunking.policies.language.fields import INSTRUCTION
from lerobot_act_chunking.policies.language.make import make_instruction
from lerobot_act_chunking.policies.prefix import prefix_predictions
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer


class VqbetNetwork(nn.Module):
    """Observations of each step, an action query behind them, and further queries at the end.

    The sequence is ``o_1 q o_2 q ... o_H q q q``: a query sees the observations up to its step. All queries
    are the same learned vector and differ by their positions. Where queries stand follows from the tokens
    that there are (LeRobot counts features instead and reads the wrong tokens if there is a third one). Given
    first actions are added to the current step's query, an instruction to all of them.
    """

    def __init__(
        self,
        *,
        history: HistoryTokens,
        gpt: Gpt,
        code_head: CodeHead,
        offset_head: ConditionedOffset | TableOffset,
        prefix_encoder: PrefixEncoder | None,
        instruction: InstructionEmbedding | None = None,
    ):
        super().__init__()
        self.history = history
        self.gpt = gpt
        self.query = nn.Parameter(torch.randn(gpt.dim))
        self.code_head = code_head
        self.offset_head = offset_head
        self.prefix_encoder = prefix_encoder
        self.instruction = instruction
        self.told = None if instruction is None else nn.Linear(instruction.reader.dim, gpt.dim)

    def forward(
        self, window: Observation, n_future: int, given: GivenActions | None = None
    ) -> Float[Tensor, "B Q D"]:
        """Features of the queries of all observations and of ``n_future`` more."""
        steps = self._steps(window, given)
        n_steps, n_tokens = steps.shape[1:3]
        future = self._query(window).expand(-1, n_future, -1)
        features = self.gpt(torch.cat((steps.flatten(1, 2), future), dim=1))
        past = features[:, : n_steps * n_tokens].unflatten(1, (n_steps, n_tokens))[:, :, -1]
        return torch.cat((past, features[:, n_steps * n_tokens :]), dim=1)

    def current(self, window: Observation, given: GivenActions | None = None) -> Float[Tensor, "B D"]:
        """Features of the current step's query alone, as for acting."""
        return self.gpt(self._steps(window, given).flatten(1, 2), n_last=1)[:, 0]

    def _steps(self, window: Observation, given: GivenActions | None) -> Float[Tensor, "B H n D"]:
        """Tokens of each step with its query behind them."""
        tokens = self.history(window.vectors, window.images)
        queries = self._query(window)[:, None].expand(-1, tokens.shape[1], -1, -1)
        if given is not None and self.prefix_encoder is not None:
            continuing = queries[:, -1:] + self.prefix_encoder(given)[:, None, None]
            queries = torch.cat((queries[:, :-1], continuing), dim=1)
        return torch.cat((tokens, queries), dim=2)

    def _query(self, window: Observation) -> Float[Tensor, "B 1 D"]:
        """The query that asks for what the policy is told."""
        if self.told is None:
            return self.query.expand(window.batch_size, 1, -1)
        return self.query + self.told(window.vectors[INSTRUCTION][:, -1:])

    def actions(
        self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"], tokenizer: ActionTokenizer
    ) -> Float[Tensor, "N C A"]:
        """The chunk that the codes stand for, with its offset (Lee et al. 2024, eq. 5)."""
        with torch.no_grad():
            decoded = tokenizer.decode(codes)
        return decoded + self.offset_head(features, codes, decoded)


def build_network(
    config: VqbetChunkedConfig, tokenizer: ActionTokenizer, backbone_weights: str | None
) -> VqbetNetwork:
    """The network that ``config`` describes, for the codes of ``tokenizer``."""
    features, dim = config.feature_spec, config.gpt_hidden_dim
    (action_dim,) = features.action
    hidden, chunk = tuple(config.head_hidden_dims), (config.chunk_size, action_dim)
    history = _history(config, backbone_weights)
    max_tokens = config.n_obs_steps * (history.n_tokens + 1) + config.n_action_pred_token - 1
    codes = tokenizer.n_codes, tokenizer.vocabulary
    return VqbetNetwork(
        history=history,
        gpt=Gpt(
            dim=dim,
            n_heads=config.gpt_n_head,
            n_layers=config.gpt_n_layer,
            max_tokens=max_tokens,
            dropout=config.dropout,
        ),
        code_head=CodeHead(dim, hidden, *codes, sequential=config.sequentially_select),
        offset_head=ConditionedOffset(dim, hidden, *chunk)
        if config.offset_mode == "code_conditioned"
        else TableOffset(dim, hidden, *codes, *chunk),
        prefix_encoder=PrefixEncoder(prefix_predictions(config), action_dim, dim)
        if config.prefix_steps
        else None,
        instruction=make_instruction(config),
    )


def _history(config: VqbetChunkedConfig, weights: str | None) -> HistoryTokens:
    features = config.feature_spec
    dims = {key: dim for key, (dim,) in features.vectors.items()}
    cameras = None
    if features.images:
        backbone = make_backbone(config.vision_backbone, config.backbone_norm, weights)
        cameras = CameraKeypoints(features.seen, config.spatial_softmax_num_keypoints, *backbone)
    return HistoryTokens(dims, cameras, config.gpt_hidden_dim)
