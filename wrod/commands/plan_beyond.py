"""What `wrod plan` says of the rod beyond the grip."""


def beyond_the_grip(trajectory, joint_path) -> tuple[dict | None, list[str]]:
    """Figures of what hangs beyond the grip, and a sentence each of the table and of the arm where
    it meets them; nothing where the rod is held at its end."""
    if not trajectory.beyond_grip:  # nor what computes it is loaded
        return None, []
    from wrod.planning.beyond import Beyond, longest_free

    beyond = Beyond.of(trajectory)
    if beyond is None:
        return None, []
    free, from_laid, notes = trajectory.beyond_grip, None, []
    if beyond.touches.any():
        free, from_laid = longest_free(trajectory), float(beyond.laid[beyond.touches.argmax()])
        onto = " and onto what lies there" if beyond.lies_on.any() else ""
        notes.append(
            f"what hangs beyond the grip comes down to the table{onto} when {from_laid:.3f} m are "
            f"laid: cut off all but {free:.3f} m of it, as scenes show it, or hold it up"
        )
    figures = {"off_the_table": free, "on_the_table_from": from_laid, "met": None}
    if joint_path is not None:
        from wrod.robot.beyond import met_beyond

        met = met_beyond(joint_path, beyond)
        if met is not None:
            figures["met"] = {"link": met.link, "free": met.free, "laid": met.laid}
            notes.append(
                f"what hangs beyond the grip may meet the arm's link {met.link} {met.free:.3f} m "
                f"from the grip, for the first time when {met.laid:.3f} m are laid: cut it off "
                "there, or lead it aside"
            )
    return figures, notes
