"""What every package may use: wording, defaults, immutable values, the look of a scene."""
