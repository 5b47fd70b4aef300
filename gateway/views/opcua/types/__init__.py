"""Types of the OPC UA server: RigType in the product's namespace, and what it needs of DI and Machinery.

Read `layout.py` first (the nodes of a rig), then `rig_type.py` (the same nodes as a type).  `companion.py` has the
nodes of the companion specifications, `nodeset.py` the types as a NodeSet2 file.
"""
