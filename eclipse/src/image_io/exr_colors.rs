//! Which channels of an OpenEXR file are the picture: renderers keep many others beside it.

/// What channels of colour are called, the fullest first; some programs write them small.
const COLORS: [&[&str]; 6] = [
    &["R", "G", "B", "A"],
    &["R", "G", "B"],
    &["r", "g", "b", "a"],
    &["r", "g", "b"],
    &["Y", "A"],
    &["Y"],
];
/// Blender's name for the picture among its passes.
const COMBINED: &str = "combined";

/// The places in `names` of RGB or Y, with alpha last where there is one.
///
/// Channels of layers (`Combined.R`) count when no plain ones exist: of Blender's picture before those of other passes, of which
/// the first in the alphabet is taken.
pub(super) fn colors(names: &[String]) -> Option<Vec<usize>> {
    let reds = || {
        names
            .iter()
            .filter_map(|name| name.strip_suffix(['R', 'r']))
    };
    let combined = reds().filter(|layer| is_combined(layer));
    let others = reds().filter(|layer| !is_combined(layer));
    [""].into_iter()
        .chain(combined)
        .chain(others)
        .find_map(|layer| of_layer(names, layer))
}

/// Whether a layer, with the dot that ends it, is Blender's picture, as `ViewLayer.Combined.` is.
fn is_combined(layer: &str) -> bool {
    let last = layer
        .strip_suffix('.')
        .and_then(|path| path.rsplit('.').next());
    last.is_some_and(|last| last.eq_ignore_ascii_case(COMBINED))
}

fn of_layer(names: &[String], layer: &str) -> Option<Vec<usize>> {
    let place = |color: &str| {
        let is_it = |name: &String| name.strip_prefix(layer) == Some(color);
        names.iter().position(is_it)
    };
    // Beside X, Y is a coordinate of a position or a normal.
    let is_vector = place("X").is_some();
    let of = |colors: &&[&str]| colors.iter().map(|color| place(color)).collect();
    COLORS
        .iter()
        .filter(|colors| !(is_vector && colors.contains(&"Y")))
        .find_map(of)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(names: &[&str]) -> Option<Vec<String>> {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let places = colors(&names)?;
        Some(places.iter().map(|&place| names[place].clone()).collect())
    }

    #[test]
    fn the_picture_is_found_among_passes() {
        let cases: [(&[&str], &[&str]); 7] = [
            (&["A", "B", "G", "R", "Z"], &["R", "G", "B", "A"]),
            (&["a", "b", "g", "r"], &["r", "g", "b", "a"]),
            (&["Y", "Z"], &["Y"]),
            (
                &["Albedo.B", "Albedo.G", "Albedo.R", "B", "G", "R"],
                &["R", "G", "B"],
            ),
            (
                &[
                    "Albedo.B",
                    "Albedo.G",
                    "Albedo.R",
                    "Combined.B",
                    "Combined.G",
                    "Combined.R",
                ],
                &["Combined.R", "Combined.G", "Combined.B"],
            ),
            (
                &[
                    "V.AO.B",
                    "V.AO.G",
                    "V.AO.R",
                    "V.Combined.A",
                    "V.Combined.B",
                    "V.Combined.G",
                    "V.Combined.R",
                ],
                &[
                    "V.Combined.R",
                    "V.Combined.G",
                    "V.Combined.B",
                    "V.Combined.A",
                ],
            ),
            (
                &["X", "Y", "Z", "diffuse.B", "diffuse.G", "diffuse.R"],
                &["diffuse.R", "diffuse.G", "diffuse.B"],
            ),
        ];
        for (names, expected) in cases {
            assert_eq!(found(names).unwrap(), expected, "{names:?}");
        }
    }

    #[test]
    fn what_is_no_colour_is_none() {
        for names in [
            &["X", "Y", "Z"][..],
            &["Z"],
            &["N.X", "N.Y", "N.Z"],
            &["colour"],
            &[],
        ] {
            assert_eq!(found(names), None, "{names:?}");
        }
    }
}
