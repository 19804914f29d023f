"""Bags whose metadata names a database: an honest one, or one outside of the bag's folder."""

import shutil

from .kit import EITHER, PATH, READ, good, hostile, metadata, renamed


@hostile(PATH, must=READ, name=("a#b.db3", "a?b.db3", "50%25.db3", "%2F.db3", "a b.db3", "ü.db3", "a%00.db3"))
def an_honest_name(folder, rng, name):
    return renamed(good(folder, "bag"), name)


@hostile(PATH, must=READ, name=("a#b", "a?b", "50%25", "a b", "ü"))
def an_honest_folder(folder, rng, name):
    path = good(folder, "bag")
    return path.rename(folder / f"{name}{rng.randint(0, 99)}")


@hostile(PATH, must=READ)
def the_bags_own_name_in_front(folder, rng):
    path = good(folder, "bag")
    return metadata(path, relative_file_paths=[f"bag/{next(path.glob('*.db3')).name}"])


@hostile(PATH, how=("decoded", "above", "absolute", "linked", "folder linked", "metadata linked"))
def a_database_elsewhere(folder, rng, how):
    path = good(folder, "bag")
    secret, own = folder / "secret", next(path.glob("*.db3"))
    secret.mkdir()
    other = own.rename(secret / "s.db3")
    if how == "decoded":
        slash = rng.choice(["%2F", "%2f", "%252F"])
        # a library that decodes names finds the secret; the name itself must exist for it to look
        name = f"..{slash}secret{slash}s.db3"
        (path / name).write_bytes(b"")
    elif how == "linked":
        name = "s.db3"
        (path / name).symlink_to(rng.choice([other, "../secret/s.db3"]))
    elif how == "metadata linked":
        name = "s.db3"
        shutil.copy(other, path / name)
    else:
        name = {"above": "../secret/s.db3", "absolute": str(other)}.get(how, "inside/s.db3")
        if how == "folder linked":
            (path / "inside").symlink_to(secret)
    metadata(path, relative_file_paths=[name])
    if how == "metadata linked":
        shutil.move(path / "metadata.yaml", secret / "metadata.yaml")
        (path / "metadata.yaml").symlink_to(secret / "metadata.yaml")
    return path


@hostile(PATH, must=EITHER)
def a_name_of_any_kind(folder, rng):
    path = good(folder, "bag")
    letters = "ab/.%#?\\\0\n 2Ff~é$*"
    return metadata(path, relative_file_paths=["".join(rng.choices(letters, k=rng.randint(0, 12)))])
