"""Bimanual ALOHA simulation on raw MuJoCo: gym-aloha's models, actions and rewards without dm_control."""
