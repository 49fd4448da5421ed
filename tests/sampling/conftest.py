from jaxtyping import install_import_hook

install_import_hook("lerobot_act_chunking.sampling", "beartype.beartype")
