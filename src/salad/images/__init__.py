"""Photos: finding them, what is known of each, decoding them."""
