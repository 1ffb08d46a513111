//! The coupled two-sheet problem with all its unknowns in one sparse Cholesky system. Slower than
//! [`TwoSheets::impedance`], but exact for any ratio of conductances; used to test it.

use dermis_tomo::sparse::{Ordering, SparseError, SpdStructure};
use faer::Mat;

use super::element::{PAIRS, SheetConductance, stiffness, weighted_mass};
use super::sheet_body::refuse;
use super::two_sheets::{TwoSheets, joint_entries};

/// Transfer impedances as in [`TwoSheets::impedance`], for a shortcut sheet of any conductance (siemens). If nothing
/// touches at all, one node ties the floating sheet to ground; no current flows through it.
///
/// # Errors
/// A singular system, or a sheet with slits along its edges ([`TwoSheets::set_slit_paths`]), which has additional
/// unknowns.
pub fn direct_impedance(
    sheets: &TwoSheets,
    shortcut_s: f64,
    contact_s_per_m2: &[f64],
) -> Result<Mat<f64>, SparseError> {
    if sheets.second.count > 0 {
        return Err(refuse("expected a sheet without slits along its edges".into()));
    }
    let (nodes, electrodes) = (sheets.positions.len(), sheets.electrode_count - 1);
    let size = 2 * nodes + electrodes;
    // Unknowns: u at the nodes, electrodes, v at the nodes.
    let upper = |node: u32| (nodes + electrodes) as u32 + node;
    let mut entries: Vec<((u32, u32), f64)> =
        sheets.contacts.iter().map(|entry| ((entry.row, entry.column), entry.value)).collect();
    entries.extend(sheets.joints.iter().flat_map(|joint| joint_entries(joint, &sheets.positions)));
    for (element, triangle) in sheets.triangles.iter().enumerate() {
        let corners = triangle.map(|node| sheets.positions[node as usize]);
        let g = triangle.map(|node| contact_s_per_m2[node as usize]);
        let sensing = stiffness(corners, sheets.sensing[element]);
        let shortcut = stiffness(corners, SheetConductance::isotropic(shortcut_s));
        let contact = weighted_mass(sheets.areas[element], g);
        for (k, &(a, b)) in PAIRS.iter().enumerate() {
            let (a, b) = (triangle[a], triangle[b]);
            entries.push(((a, b), sensing[k] + contact[k]));
            entries.push(((upper(a), upper(b)), shortcut[k] + contact[k]));
            entries.push(((a, upper(b)), -contact[k]));
            if a != b {
                entries.push(((b, upper(a)), -contact[k]));
            }
        }
    }
    if contact_s_per_m2.iter().all(|&g| g == 0.0) {
        entries.push(((upper(0), upper(0)), shortcut_s));
    }
    let mut places: Vec<[f64; 3]> = sheets.positions.iter().map(|p| [p[0], p[1], 0.0]).collect();
    places.extend((0..electrodes).map(|_| [0.0; 3]));
    places.extend(sheets.positions.iter().map(|p| [p[0], p[1], 1e-6]));
    for entry in &sheets.contacts {
        if entry.row as usize >= nodes && (entry.column as usize) < nodes {
            places[entry.row as usize] = places[entry.column as usize];
        }
    }
    let positions: Vec<(u32, u32)> = entries.iter().map(|entry| entry.0).collect();
    let (structure, slots) = SpdStructure::new(size, &positions, Ordering::Dissection(&places))?;
    let mut values = vec![0.0; structure.value_count()];
    for (slot, entry) in slots.iter().zip(&entries) {
        values[*slot as usize] += entry.1;
    }
    let factor = structure.factor(&values)?;
    let mut columns = Mat::zeros(size, electrodes);
    (0..electrodes).for_each(|electrode| columns[(nodes + electrode, electrode)] = 1.0);
    structure.solve_in_place(&factor, columns.as_mut());
    let known = |row: usize, column: usize| row < electrodes && column < electrodes;
    Ok(Mat::from_fn(electrodes + 1, electrodes + 1, |row, column| {
        if known(row, column) { columns[(nodes + row, column)] } else { 0.0 }
    }))
}
