"""How strong the agents seem: the estimators that SIMPLE proposes strengths by."""
