"""Friction of each joint over all samples: what presliding and sliding the logs show, and the law that predicts it."""
