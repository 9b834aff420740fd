"""``python -m vocc_torch``: the command line."""

from vocc_torch.app.cli import main

if __name__ == "__main__":
    main()
