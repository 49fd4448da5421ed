import pytest
import torch

from lerobot_act_chunking.heads.regression import RegressionHead

B, Q, D, A = 3, 5, 16, 4


def test_each_query_emits_consecutive_actions():
    head = RegressionHead(D, A, actions_per_query=2)
    features = torch.randn(B, Q, D)
    actions = head(features)
    assert actions.shape == (B, 2 * Q, A)
    torch.testing.assert_close(actions[:, 7], head.projection(features)[:, 3, A:])  # as checkpoints store it
    changed = features.clone()
    changed[:, 3] += 1
    differs = (head(changed) != actions).any((0, 2))
    assert differs.nonzero().flatten().tolist() == [6, 7]


def test_one_action_per_query_is_a_linear_layer():
    head = RegressionHead(D, A, actions_per_query=1)
    features = torch.randn(B, Q, D)
    torch.testing.assert_close(head(features), head.projection(features))


@pytest.mark.parametrize(("power", "expected"), [(1, 2.5), (2, 6.25)])
def test_loss_is_the_error_of_each_element(power, expected):
    head = RegressionHead(D, A, actions_per_query=1, power=power)
    features = torch.randn(B, Q, D)
    loss = head.element_loss(features, head(features) + torch.tensor([2.5, -2.5, 2.5, -2.5]))
    torch.testing.assert_close(loss, torch.full((B, Q, A), expected))
