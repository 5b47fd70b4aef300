"""Access control: roles, users, certificates, and which listeners may be open.

Read `roles.py` first (the table of rights), then `users.py` (the users and their roles).
"""
