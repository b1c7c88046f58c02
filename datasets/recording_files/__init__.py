"""The other files of a recording: recording.toml with its keys and schema, robot.toml, images.csv and its images."""
