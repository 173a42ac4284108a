"""What the sonar hears: one law a file, each with its source; `sonar.AcousticModel` puts them together."""
