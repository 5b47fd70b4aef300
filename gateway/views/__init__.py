"""User interfaces to the bus: OPC UA, Foxglove, web pages.  Each is a process of its own."""
