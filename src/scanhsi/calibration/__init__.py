"""From counts to what they mean: colour, quick pictures."""
