"""Is a model good enough?  The paper's figures from any campaign, with a number under each."""
