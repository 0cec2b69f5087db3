"""What `make dist` does beyond packing files: machine code of the kernels for those who install the wheel."""
