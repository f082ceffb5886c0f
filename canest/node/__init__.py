"""The daemon as a J1939 node: address claim, network management, broadcast."""
