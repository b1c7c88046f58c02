"""Pages of the sensor's commands: camera, scanner, scans and hand-eye."""
