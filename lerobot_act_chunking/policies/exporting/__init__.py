"""Policies as ONNX graphs with plain files beside them, for `act_chunking_runtime`.

`acting` says what a policy type has to tell, `network` puts preprocessor and policy into one module,
`onnx_graph` translates it, `export` writes the folder.
"""
