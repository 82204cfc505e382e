"""Reading a video step by step: hidden state, beliefs and intents, each given what was seen."""
