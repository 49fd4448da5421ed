"""A simulated SO-101 for LeRobot's own commands: ``--robot.type=so_arm_sim``, ``--teleop.type=so_arm_sim``.

The modules and classes are named so that LeRobot finds a device by its configuration: ``XConfig`` in
``config_y`` makes an ``X`` of ``y``.
"""
