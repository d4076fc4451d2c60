from tactune.app.worker.threads import Mailbox


def test_the_newest_item_wins_and_older_ones_are_counted():
    box: Mailbox[int] = Mailbox()
    assert box.put(1) is True
    assert box.put(2) is False
    assert box.put(3) is False
    assert box.take() == 3
    assert box.take() is None
    assert box.dropped == 2


def test_a_better_version_of_an_item_drops_nothing():
    box: Mailbox[float] = Mailbox(lambda old, new: int(old) == int(new))
    box.put(1.0)
    assert box.put(1.5) is False
    assert box.dropped == 0
    box.put(2.0)
    assert box.dropped == 1
    assert box.take() == 2.0


def test_taking_makes_room_for_another_wake_up():
    box: Mailbox[int] = Mailbox()
    box.put(1)
    box.take()
    assert box.put(2) is True
    assert box.dropped == 0
