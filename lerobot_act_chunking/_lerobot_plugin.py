import lerobot_act_chunking.plugin  # noqa: F401  (installed as lerobot_policy_act_chunking; keep it one import)
