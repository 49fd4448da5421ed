"""The layers of `nn.layers` and `nn.attention`, computed in another order where this is faster on a CPU.

The results are the same up to rounding (tests/nn/cpu). `nn.transformer` and `nn.style_encoder` are built from
these layers. To go without them, import the names from `nn.layers` and `nn.attention` there instead.
"""
