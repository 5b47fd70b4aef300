"""The HTTP and WebSocket API for programs without a binding of the bus: /api/v1 and /metrics.

Read `endpoints.py` and `job_endpoints.py` first (the tables of paths), then `resource.py` (one request), `commands.py`,
`forms.py` and `shapes.py` (what goes in and out), `openapi.py` (the description, made of those tables).

Rule: nothing is decided here.  Rights, acts and refusals are those of the page (actions.py, acts.py).
"""
