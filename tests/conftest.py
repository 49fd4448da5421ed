"""Checks every shape annotation of the tensor code while the tests run."""

from jaxtyping import install_import_hook

# Before anything imports them: annotations become checks only in modules that are imported afterwards.
CHECKED = ("nn", "heads", "execution", "data", "policies.act_chunked.network")
install_import_hook([f"lerobot_act_chunking.{module}" for module in CHECKED], "beartype.beartype")
