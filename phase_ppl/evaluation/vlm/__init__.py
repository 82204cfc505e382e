"""A vision-language model at work: what is sent, who answers, what is read and kept."""
