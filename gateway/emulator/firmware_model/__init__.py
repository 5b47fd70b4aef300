"""The firmware of the emulated board: tick, control law, commands, memory, UART.

Reading order: `arithmetic.py`, `law.py`, `flash.py`, `control_loop.py`, `commands.py`, `uart.py`, `board.py`.
"""
