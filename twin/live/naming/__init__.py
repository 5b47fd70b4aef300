"""The name of a cause while the rig flies: windows of samples, their score tests, and a decision over windows."""
