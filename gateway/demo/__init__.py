"""What `board51 demo` is made of: processes as a user starts them, a view of the bus, and what the log says.

It imports nothing of the emulator or the twin: whatever it shows went through their commands.
"""
