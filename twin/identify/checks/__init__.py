"""Is a recording what it says it is?  Each check by itself; `plausibility` asks them all."""
