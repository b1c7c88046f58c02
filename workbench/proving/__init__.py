"""The examination that a diagnosis must pass in public: suites, fixed rules of scoring, the scoreboard's figures."""
