"""What comparing kernels needs: the contenders and a reference to hold them against."""
