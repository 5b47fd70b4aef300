"""The firmware's image for an ATmega328P (`firmware/avr`), in libsimavr: `build.py`, `board.py`, `simavr.c`."""
