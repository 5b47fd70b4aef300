"""Mirrors on the bus: the service, its boards, and models handed over to it."""
