"""Commands about the sensor: camera, scanner, scan, handeye and render."""
