"""Who may do what: roles, users, certificates, and which listeners may be open.

Read `roles.py` first (the one table), then `users.py` (who has which role).
"""
