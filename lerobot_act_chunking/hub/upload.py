"""Taking a repository from the local hub to the real one, later, when there is a network and a login."""

from pathlib import Path

from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

from lerobot_act_chunking.hub.repository import MAIN, Repository


def publish(
    repository: Repository, api: HfApi, *, repo_id: str | None = None, private: bool = False
) -> list[str]:
    """Push every tagged revision, oldest first, then the head of ``main``, with messages and tags.

    Running it again sends only what changed. Revisions without a tag stay local.

    Args:
        repository: what to publish.
        api: the destination; its requests must not be routed to the local hub.
        repo_id: the name there, if another one.
        private: create the repository there as private.

    Returns:
        The commit addresses, in order.
    """
    kind, target = repository.name.kind, repo_id or repository.name.repo_id
    target = api.create_repo(target, repo_type=kind, private=private, exist_ok=True).repo_id
    present = {tag.name for tag in api.list_repo_refs(target, repo_type=kind).tags}
    tags: dict[str, list[str]] = {}
    for tag in repository.tags() - present:
        tags.setdefault(repository.resolve(tag), []).append(tag)
    order = [commit_id for commit_id in repository.revisions() if commit_id in tags]
    addresses = []
    for commit_id in dict.fromkeys([*order, repository.resolve(MAIN)]):
        info = _send(repository, commit_id, api, target)
        addresses.append(str(info.commit_url))
        for tag in sorted(tags.get(commit_id, [])):
            api.create_tag(target, tag=tag, revision=info.oid, repo_type=kind, exist_ok=True)
    return addresses


def _send(repository: Repository, commit_id: str, api: HfApi, target: str):
    commit = repository.commit(commit_id)
    folder, kind = repository.snapshots / commit_id, repository.name.kind
    # .gitattributes is the real Hub's own file.
    stale = set(api.list_repo_files(target, repo_type=kind)) - set(commit.files) - {".gitattributes"}
    operations: list[CommitOperationAdd | CommitOperationDelete] = [
        CommitOperationAdd(path, str(Path(folder / path).resolve())) for path in sorted(commit.files)
    ]
    operations += [CommitOperationDelete(path, is_folder=False) for path in sorted(stale)]
    return api.create_commit(
        target,
        operations,
        repo_type=kind,
        commit_message=commit.title,
        commit_description=commit.description or None,
    )
