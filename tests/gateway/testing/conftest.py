"""The example is a project of its own, as a user would have it: test_plugin.py runs it, not this suite."""

collect_ignore = ["example_project"]
