"""The emulated board's program: tick, control law, commands, memory, UART."""
