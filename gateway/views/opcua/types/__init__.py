"""Types of the OPC UA server: RigType in the product's namespace, and what it needs of DI and Machinery.

The NodeSet2 files in `protocol/opcua` have all nodes of the types; `nodeset.py` reads them and makes the rigs.
"""
