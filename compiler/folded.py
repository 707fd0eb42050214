def folded(program, macs):
    raise NotImplementedError
