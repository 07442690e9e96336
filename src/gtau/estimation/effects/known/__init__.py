"""The effects: a module each, whose EFFECT or EFFECTS are tried with every fit."""
