"""CAN interfaces: SocketCAN by our own raw socket, all others through python-can."""
