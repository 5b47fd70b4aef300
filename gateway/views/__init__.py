"""Windows onto the bus for people and their tools: OPC UA, Foxglove, web pages.  Each is a process of its own."""
