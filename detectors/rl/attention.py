"""A plain transformer that reads raw windows, to compare with the pair network."""

from __future__ import annotations

from torch import Tensor, nn

from detectors.rl.pair import finish_outputs


class AttentionNetwork(nn.Module):
    """Embeds the track of each UAV, lets the UAVs attend to each other, and judges each.

    The order of the UAVs doesn't matter, and their number may change; T_ob and the orientation of space do matter.

    Args:
        steps: T_ob.
        width: size of an embedding.
        heads: attention heads.
        layers: layers of attention.
    """

    def __init__(self, steps: int, width: int = 64, heads: int = 4, layers: int = 2) -> None:
        super().__init__()
        self.embed = nn.Linear(3 * steps, width)
        layer = nn.TransformerEncoderLayer(width, heads, 2 * width, dropout=0.0, batch_first=True, norm_first=True)
        self.attend = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)
        self.judge = nn.Linear(width, 2)

    def forward(self, velocity: Tensor, alive: Tensor) -> tuple[Tensor, Tensor]:
        """``(B, N)`` logits of being a candidate, and ``(B,)`` values; see :class:`detectors.rl.PairNetwork`."""
        living = alive > 0
        is_masked = ~living & living.any(dim=1, keepdim=True)  # attention to no UAV would be NaN
        tracks = velocity.transpose(1, 2).flatten(2)  # (B, N, 3 T_ob)
        outputs = self.judge(self.attend(self.embed(tracks), src_key_padding_mask=is_masked))
        return finish_outputs(outputs[..., 0], outputs[..., 1], living)
