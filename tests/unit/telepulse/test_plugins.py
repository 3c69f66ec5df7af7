from telepulse.plugins import GROUPS


def test_own_kinds_can_be_used_and_are_listed_once() -> None:
    listed = [each for group in GROUPS for each in group.listed()]
    own = [(each.group, each.kind) for each in listed if each.distribution == "telepulse"]
    assert len(own) == len(set(own)) == sum(len(group.own) for group in GROUPS)
    assert [each for each in listed if each.problem] == []
