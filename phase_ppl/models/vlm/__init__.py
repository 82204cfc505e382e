"""A vision-language model that watches the animation (paper, Appendix "Gemini 2.5 Pro")."""
