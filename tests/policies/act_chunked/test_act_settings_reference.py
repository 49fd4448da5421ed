from lerobot_act_chunking.policies.settings_reference import settings_of


def test_known_values_of_the_reference():
    act = {setting.name: setting for setting in settings_of("act_chunked")}
    assert dict(act["optimizer_lr"].values) == {
        "base": "0.0005",
        "paper": "1e-05",
        "autoregressive": "0.0005",
    }
    assert dict(act["use_vae"].values) == {"base": "false", "paper": "true", "autoregressive": "true"}
    assert act["latent_type"].allowed.startswith("gaussian, conditional, mixture, categorical")
    assert act["min_std"].allowed == "number, above 0 to below 1"
    assert act["fps"].allowed == "number, above 0 to 100000, or null"
    assert act["optimizer_betas"].values["base"] == "[0.9, 0.95]"
    assert act["n_components"].meaning == "number of components of `gmm`."
    groups = {act[name].group for name in ("fps", "optimizer_lr", "vision_backbone")}
    assert groups == {"all policies of this package"}
    assert act["execution"].group == act["gripper_dims"].group == "chunk execution"
