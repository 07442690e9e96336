"""Friction of each joint from all samples: presliding and sliding in the logs, and the law that predicts it."""
