"""What a campaign offers: its recordings, prepared, with what is known of them without a model."""
