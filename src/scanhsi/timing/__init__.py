"""Time as physics: delays, the bounds they set, what a scan made of them."""
