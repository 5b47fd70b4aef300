# The compilers' flags of each target: NAME = words, a line each.  The Makefile includes this file; board51 reads the same
# lines (gateway/emulator/native/flags.py).  So an image is the same whoever builds it.

# A shared library for this computer.
POSIX_FLAGS = -std=c99 -O2 -fPIC -shared
# On Linux: its functions call each other, whatever another library of the process has called by the same name.
POSIX_LINUX = -Wl,-Bsymbolic
SANITIZE_FLAGS = -g -O1 -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all

# ATmega328P.  Inlined, all functions of a signal would have their locals on the stack at a time.
AVR_FLAGS = -mmcu=atmega328p -std=gnu99 -O2 -fno-inline
# 200 samples (40 ms) and short queues: what the 2 kB of RAM hold beside the stack.
AVR_CONFIG = -DB51_CAPTURE_SIZE=200U -DB51_CAPTURE_US=200U -DB51_ANSWER_DEPTH=2U -DB51_EVENT_DEPTH=6U -DB51_BLOCK_DEPTH=1U
# Not the EEPROM: a boot loader does not write it, and blank it gives way to the program's numbers.
AVR_HEX_FLAGS = -R .eeprom

# ADuC841.
MCS51_FLAGS = -mmcs51 --std-c99 --model-small --opt-code-speed
# What 2 kB of external RAM hold, and the fastest capture that its interrupt leaves time for.
MCS51_CONFIG = -DB51_CAPTURE_US=80U -DB51_CAPTURE_SIZE=240U -DB51_ANSWER_DEPTH=3U -DB51_EVENT_DEPTH=8U -DB51_BLOCK_DEPTH=2U
# 'Memory organization'; B51_XRAM_KEPT in mcs51/part.h.  88 bytes of stack were the most that a test has met.
MCS51_LINK = --iram-size 256 --stack-size 104 --xram-size 2040 --code-size 63488

# Each is an error in the tests and in the Makefile.
WARNINGS = -Wall -Wextra -Wconversion -Wshadow -Werror
POSIX_WARNINGS = -pedantic -Wsign-conversion
MCS51_WARNINGS = --Werror
